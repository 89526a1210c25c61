"""Tests of imucal.calibration."""
