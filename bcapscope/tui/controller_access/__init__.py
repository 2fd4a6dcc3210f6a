"""How the Tester uses the session of `live.controller`. This package contains no widgets."""
