"""The terminal screen."""

import os

# Textual draws what a key did up to two of these turns after what it drew before, and reads this once.
os.environ.setdefault("TEXTUAL_FPS", "240")
