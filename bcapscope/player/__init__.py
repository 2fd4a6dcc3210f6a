"""Playing trajectories in slave mode: reading them, checking them before anything moves, keeping the pace."""
