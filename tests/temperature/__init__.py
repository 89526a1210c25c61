"""Tests of the bias over temperature."""
