"""Versions: of the diagnosis, which every report states, and of what it keeps, which are in the keys of the cache."""

MODEL_VERSION = "drapemeter-diagnosis/20"
SIMULATION_VERSION = 4
"""Raised when the solver's results change: cached drapes of another number are not used."""
RESPONSES_VERSION = 2
"""Raised when what is measured on a simulated picture changes."""
PIXELS_VERSION = 6
"""The same of pixel statistics."""
LED_VERSION = 2
"""Raised when captures lead the solver otherwise than before."""
