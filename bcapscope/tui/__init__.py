"""The terminal screen."""

import os

# Textual draws up to two frames after the update that a key caused, and reads this variable at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
