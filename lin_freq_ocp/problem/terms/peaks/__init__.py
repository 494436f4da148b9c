"""Local maxima of spectra, and of vibrations over boxes of plants, relative to their limits."""
