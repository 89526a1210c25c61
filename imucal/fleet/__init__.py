"""fleet: the logs of many units -> what the sensor model is like, and which unit is odd."""

from imucal.fleet.pooling import PooledFit, log_values, pool
from imucal.fleet.population import Population, population
from imucal.fleet.values import LogValue

__all__ = ["LogValue", "PooledFit", "Population", "log_values", "pool", "population"]
