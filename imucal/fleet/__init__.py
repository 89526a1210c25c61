"""fleet: the logs of many units -> what the sensor model is like, and which unit is odd."""

from imucal.fleet.log_terms import log_values
from imucal.fleet.log_value import LogValue
from imucal.fleet.pooling import PooledFit, pool
from imucal.fleet.population import Population, population
from imucal.fleet.trend import Trend, trend

__all__ = ["LogValue", "PooledFit", "Population", "Trend", "log_values", "pool", "population", "trend"]
