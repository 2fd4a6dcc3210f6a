"""How our simulator tells that it is one.

No address proves that there is no robot behind it: a loopback address may be a proxy's. A real controller
refuses a variable that it does not know (ShoheiKobata/orin_bcap_python_samples lists those of RC8).
"""

from __future__ import annotations

SIMULATOR_VARIABLE = "@BCAPSCOPE_SIMULATOR"
"""Variable of the controller object that only our simulator has."""

SIMULATOR_TEXT = "bcapscope simulator: no robot moves"
"""Its value, a VT_BSTR."""
