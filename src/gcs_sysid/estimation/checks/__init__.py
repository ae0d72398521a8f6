"""Does a fit predict, is the body rigid, is the layout the vehicle's?"""
