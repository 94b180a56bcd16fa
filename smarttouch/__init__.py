"""SmartTouch: touch what a sensor sees.

Optical frames of print become a tactile image, the tactile image becomes a
time-division scan sequence of optimizer-designed kernels, and the sequence is
proved safe before an electro-tactile display board gets it.
"""

__version__ = "0.1.0"
