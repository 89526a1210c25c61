"""Messages -> columns: which carry IMU samples, and where their numbers lie in the bytes."""

__all__: list[str] = []
