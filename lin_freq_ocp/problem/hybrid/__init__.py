"""What has modes, kinks or levels: piecewise dynamics, regions, finite sets, and search trees as data."""
