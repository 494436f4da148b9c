"""DESCRIBE: frozen descriptions of a problem and of its solutions, validated once, at construction."""
