"""PX4 ULog files."""

__all__: list[str] = []
