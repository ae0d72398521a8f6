"""From records to aligned samples: filters, time base, rotor source, flight detection."""
