"""Tests of the parts by name and their figures."""
