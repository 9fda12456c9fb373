"""What both wings mean by a servo, an angle, a frame, a calibration, a limit, and a record of the black box. Pure."""
