"""Tests of what a model predicts of a filter's errors."""
