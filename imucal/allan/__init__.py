"""Samples -> AllanCurve: what the data shows."""
