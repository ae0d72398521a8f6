"""What is in a recording or on a link, and whether a vehicle can be identified from it."""
