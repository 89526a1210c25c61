"""Maximum likelihood on the spectrum of the samples."""

__all__: list[str] = []
