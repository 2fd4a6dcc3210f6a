"""What the Tester does with the session of `live.controller`, without widgets."""
