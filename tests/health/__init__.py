"""Tests of `imucal.doctor`."""
