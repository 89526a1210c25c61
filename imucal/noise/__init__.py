"""The mathematics of noise: what can explain a curve."""

from imucal.noise.model import NoiseModel, parse_structure, structure_text
from imucal.noise.terms import (
    TERMS,
    AngleRandomWalk,
    BiasInstability,
    GaussMarkov,
    NoiseTerm,
    Quantization,
    RateRamp,
    RateRandomWalk,
)

__all__ = [
    "TERMS",
    "AngleRandomWalk",
    "BiasInstability",
    "GaussMarkov",
    "NoiseModel",
    "NoiseTerm",
    "Quantization",
    "RateRamp",
    "RateRandomWalk",
    "parse_structure",
    "structure_text",
]
