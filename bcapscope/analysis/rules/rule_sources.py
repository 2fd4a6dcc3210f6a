"""Names of documents and programs that several rules give as their source."""

from __future__ import annotations

GUIDE = "DENSO Wave 2009, How to use the Slave mode"
ERROR_LIST = "public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control"
C_SERVER = "orin_bcap C/src/bCAPServer/bcap_server.c"
C_CLIENT = "orin_bcap C/src/bCAPClient/bcap_client.c"


def guide(*sections: str) -> str:
    """Return the title of DENSO's guide to slave mode, followed by the given sections."""
    return f"{GUIDE}, {' and '.join(sections)}"
