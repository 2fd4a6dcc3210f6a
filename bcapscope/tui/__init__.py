"""The screen in the terminal: it shows what capture, traffic, analysis and render give."""
