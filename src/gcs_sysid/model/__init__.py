"""The vehicle: its airframe, its parameters and its equations of motion."""
