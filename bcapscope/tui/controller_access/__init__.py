"""The Tester's use of the session of `live.controller`, without widgets."""
