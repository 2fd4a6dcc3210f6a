"""bcapscope: see, test and simulate b-CAP, the Ethernet protocol of DENSO robot controllers."""

__version__ = "0.1.0"
