"""Temperature ramp -> bias over temperature."""

from imucal.temperature.characterizing import thermal
from imucal.temperature.result import Thermal

__all__ = ["Thermal", "thermal"]
