"""Parts: the noise figures that data sheets print, by the name of the part."""

from imucal.sensors.cautions import cautions
from imucal.sensors.part import Figure, Part, PartSensor, TermFigure
from imucal.sensors.table import every_part, find_sensor

__all__ = ["Figure", "Part", "PartSensor", "TermFigure", "cautions", "every_part", "find_sensor"]
