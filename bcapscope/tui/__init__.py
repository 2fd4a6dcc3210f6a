"""The terminal screen."""

import os

# Textual draws a change up to two screen updates later: at 240 updates per second, at most 8 ms later.
# Textual reads TEXTUAL_FPS at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
