"""From relative estimates and a scale reference to physical parameters with a status."""
