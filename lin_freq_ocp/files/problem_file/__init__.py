"""The problem file: a problem in TOML, with large arrays in an .npz beside it."""
