"""Bytes -> messages: the files that hold them, opened and cut into chunks."""

__all__: list[str] = []
