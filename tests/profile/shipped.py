"""The profiles that are shipped, and how many electrodes each has."""

SHIPPED = {
    "electric-mouse": 64, "smarttouch-4x4": 16, "line-7": 7, "line-8": 8, "kajimoto-61": 61,
    "etactilekit-32": 32, "optacon-24x6": 144, "concentric": 2,
}  # fmt: skip
