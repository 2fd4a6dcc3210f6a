"""What was recorded, played again: the client's side to a controller, or the controller's to a client."""
