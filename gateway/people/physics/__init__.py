"""The robot's body in MuJoCo: how it moves while its servos follow their targets or are off."""
