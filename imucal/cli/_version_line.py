"""``--version``: which imucal runs, and whether the other distribution of that name is in its way.

Another project on the package index is called ``imucal`` and installs a package of the same name. pip puts
both into one folder, so that the one that came last overwrites files of the other.
"""

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from imucal._version import __version__

#: This distribution, and the one that is another project's.
OURS, OTHER = "imucal-noise", "imucal"


def version_lines() -> str:
    """Return this version, where it stands and what runs it; and a warning where files may be mixed."""
    folder = Path(__file__).resolve().parent.parent
    lines = [f"imucal {__version__} ({OURS}) in {folder}, Python {platform.python_version()}"]
    try:
        other = version(OTHER)
    except PackageNotFoundError:
        return lines[0]
    lines += [
        f"The distribution {OTHER} {other}, another project's, is installed too:",
        "its files and these are mixed in one folder.",
        f"Type: pip uninstall {OTHER} {OURS}, and install {OURS} again.",
    ]
    return "\n".join(lines)
