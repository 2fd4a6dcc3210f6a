"""The terminal screen."""

import os

# Textual draws a change up to two frames later, so the frame rate is high. Textual reads TEXTUAL_FPS at
# import.
os.environ.setdefault("TEXTUAL_FPS", "240")
