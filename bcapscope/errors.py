"""The exceptions of bcapscope.

Reading never raises: bytes that make no sense become items that say so. What is raised tells whose
fault it was, so that a caller need not read the message to know what to do next.
"""


class BcapError(Exception):
    """Base of every exception that bcapscope raises on purpose."""


class LocalProtocolError(BcapError):
    """We were asked to send something that b-CAP cannot express; nothing was sent."""


class CaptureError(BcapError):
    """A capture cannot be read, or breaks off.

    Attributes:
        offset: byte offset in the (uncompressed) capture at which reading stopped, or None where
            there is no capture to have an offset in.
    """

    def __init__(self, message: str, offset: int | None = None) -> None:
        super().__init__(message)
        self.offset = offset
