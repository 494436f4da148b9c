"""Waveforms: controls whose moments or spectra are prescribed."""
