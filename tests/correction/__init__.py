"""Tests of the correction of logs."""
