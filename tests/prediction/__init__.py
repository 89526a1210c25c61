"""Tests of the predicted errors of filters."""
