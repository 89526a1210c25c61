"""AllanCurve (+ samples) -> NoiseFit: what explains it."""
