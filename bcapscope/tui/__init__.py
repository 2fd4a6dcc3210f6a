"""The screen in the terminal: it shows what capture, traffic, analysis and render give."""

import os

# What a key did is drawn after 8 ms at most; Textual reads this once.
os.environ.setdefault("TEXTUAL_FPS", "120")
