"""Sources that several rules refer to."""

from __future__ import annotations

GUIDE = "DENSO Wave 2009, How to use the Slave mode"
ERROR_LIST = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
C_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"
C_CLIENT = "orin_bcap C/src/bCAPClient/bcap_client.c"


def guide(*sections: str) -> str:
    """Return the source for some sections of DENSO's guide to slave mode."""
    return f"{GUIDE}, {' and '.join(sections)}"
