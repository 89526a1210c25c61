"""Fits of the Allan curve: GMWM and the classical reading of slopes."""

__all__: list[str] = []
