"""The first minutes: is this machine ready, and what is the vehicle like?"""
