"""The terminal screen."""

import os

# The frame rate is high, because Textual draws a change up to two screen frames later. Textual reads
# TEXTUAL_FPS at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
