"""Code for trajectories: read them, check them before anything moves, and play them in slave mode."""
