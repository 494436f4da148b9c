"""The command line as ``python -m lin_freq_ocp``."""

from lin_freq_ocp.cli.app import main

if __name__ == "__main__":
    main()
