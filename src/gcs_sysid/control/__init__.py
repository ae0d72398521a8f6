"""Rate and attitude loops of the autopilots around an identified vehicle: margins and gains."""
