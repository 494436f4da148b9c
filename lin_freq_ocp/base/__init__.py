"""What the operating system is asked for: whole files, memory, signals."""
