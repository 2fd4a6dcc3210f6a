"""The terminal screen."""

import os

# Textual draws a change up to two frames later, so a high rate is quick. It reads this variable at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
