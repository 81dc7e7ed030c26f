"""The calibrated cameras: projection, distortion, the blur of a lens at a depth, the nominal rig."""
