"""The variable by which bcapscope's simulator identifies itself.

No address proves that there is no robot behind it: a loopback address may belong to a proxy. A real
controller refuses a variable that it does not know (ShoheiKobata/orin_bcap_python_samples lists those of
RC8).
"""

from __future__ import annotations

SIMULATOR_VARIABLE = "@BCAPSCOPE_SIMULATOR"
"""Variable of the controller object that only bcapscope's simulator has."""

SIMULATOR_TEXT = "bcapscope simulator: no robot moves"
"""Value of the variable, a VT_BSTR."""
