"""Walking: body velocities in, servo angles out. Pure: time is an argument, and nothing here reads or sends.

A program, a console or a bridge drives a `Ride`. The ride decides which legs start, and stops when its driver falls
silent. `Engine` decides where the legs go, `Robot` where the feet can be.
"""
