"""Stamps -> clock: the rate, the gaps, and what was seen."""

__all__: list[str] = []
