"""Noise models: the terms that can explain an Allan curve, and their formulas."""

from imucal.noise.model import NoiseModel, parse_structure, structure_text
from imucal.noise.term import NoiseTerm, Stroke
from imucal.noise.terms import TERMS, GaussMarkov

__all__ = ["TERMS", "GaussMarkov", "NoiseModel", "NoiseTerm", "Stroke", "parse_structure", "structure_text"]
