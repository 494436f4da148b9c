"""Frequency constraints: bands that are removed, masks, energy bounds, and bounds on outputs."""

from lin_freq_ocp.base.errors import answer_misspelt
from lin_freq_ocp.problem.spectrum.bands import LinearConstraint, band_pass, high_pass, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.base import OutputSpectrum
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, MagnitudeBound
from lin_freq_ocp.problem.spectrum.residual_vibration import ResidualVibration
from lin_freq_ocp.problem.spectrum.spectrogram import Spectrogram, closed_loop
from lin_freq_ocp.problem.spectrum.standards import iec_61000_3_2_class_a, ieee_519

# fmt: off
__all__ = [
    "EnergyBound", "LinearConstraint", "MagnitudeBound", "OutputSpectrum", "ResidualVibration", "Spectrogram",
    "band_pass", "closed_loop", "high_pass", "iec_61000_3_2_class_a", "ieee_519", "low_pass", "notch", "stop_band",
]
# fmt: on

answer_misspelt(globals())
