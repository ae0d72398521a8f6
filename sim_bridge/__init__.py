"""A software-in-the-loop multirotor that sends MAVLink 2 as PX4 does."""
