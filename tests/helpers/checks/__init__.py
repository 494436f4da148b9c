"""One random or known problem after another, solved here and by an independent way, and compared: ``check(seed)``."""
