"""fleet: the logs of many units -> the statistics of the sensor model, and odd units."""

from imucal.fleet.pooling import PooledFit, log_values, pool
from imucal.fleet.population import Population, population
from imucal.fleet.values import LogValue

__all__ = ["LogValue", "PooledFit", "Population", "log_values", "pool", "population"]
