"""A software-in-the-loop multirotor that speaks MAVLink 2 as PX4 does."""
