"""Registry of the laser drivers: the values of ``laser.kind``, and the class of each.

A driver is added by one line here and one file with a class that implements `rig.control.lasers.laser.Laser`
and is called with `LaserSettings`. It is imported when it is used.
"""

LASERS: dict[str, str] = {
    "thorlabs4000": "rig.control.lasers.thorlabs4000:Thorlabs4000",
    "obis": "rig.control.lasers.obis:Obis",
    "ldc500": "rig.control.lasers.ldc500:Ldc500",
    "cobolt": "rig.control.lasers.cobolt:Cobolt",
}
