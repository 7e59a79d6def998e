"""How far the gap shrinks once the effect is added, on captures held out from finding and fitting it."""
