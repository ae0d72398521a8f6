"""The flight coach: what to fly next, and a flight plan on paper. Words only, never a command."""
