"""The terminal screen."""

import os

# Textual draws a change up to two screen updates later. At 240 updates per second, two updates take 8 ms.
# Textual reads TEXTUAL_FPS at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
