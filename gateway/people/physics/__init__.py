"""The robot's body in MuJoCo: what becomes of it when its servos go where they are sent, or go slack."""
