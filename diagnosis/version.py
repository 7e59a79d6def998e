"""Versions: of the diagnosis, which every report states, and of what it keeps, which are in the keys of the cache.

Cached drapes go by the solver's own version (``simcore.version``).
"""

MODEL_VERSION = "drapemeter-diagnosis/61"
RESPONSES_VERSION = 4
"""Raised when what is measured on a simulated picture changes."""
PIXELS_VERSION = 7
"""The same of pixel statistics."""
LED_VERSION = 4
"""Raised when captures lead the solver otherwise than before."""
