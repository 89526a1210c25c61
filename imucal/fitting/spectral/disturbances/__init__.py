"""Parts of a spectrum that are not the sensor's noise: gaps, lines, shapes in time, the output filter.

Each module finds one kind and returns its regressors, the bins to keep, and findings.
"""

__all__ = ["band", "band_search", "gaps", "lines", "not_noise", "segments"]
