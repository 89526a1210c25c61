"""``python -m imucal``."""

from imucal.cli import main

main()
