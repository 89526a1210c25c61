"""imucal: noise models of IMUs from a recording at rest, with honest intervals."""

from imucal._version import __version__

__all__ = ["__version__"]
