"""The variable that identifies bcapscope's simulator.

An address does not prove that a controller is simulated: a proxy to a real robot may listen on a loopback
address. A real controller refuses to open an unknown variable (ShoheiKobata/orin_bcap_python_samples lists
the variables of RC8).
"""

from __future__ import annotations

SIMULATOR_VARIABLE = "@BCAPSCOPE_SIMULATOR"
"""Name of a variable that only bcapscope's simulator has. The variable belongs to the controller object."""

SIMULATOR_TEXT = "bcapscope simulator: no robot moves"
"""Value of the variable `SIMULATOR_VARIABLE`; its type is VT_BSTR."""
