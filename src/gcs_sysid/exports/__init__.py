"""An identified vehicle as the files that simulators load."""
