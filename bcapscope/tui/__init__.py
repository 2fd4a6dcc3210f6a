"""The terminal screen."""

import os

# Textual redraws up to two frames after the update that a key caused, and reads this variable only at import.
os.environ.setdefault("TEXTUAL_FPS", "240")
