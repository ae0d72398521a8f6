"""Has the vehicle changed in flight, or between flights?"""
