"""What is wrong with the rig at this moment, as a control room shows it: alarms with cause, remedy and times.

`catalogue` names every alarm there is, `what_raises` which of them follow from what a desk sees, `alarm_list`
keeps their states. Nothing here asks a device, a session or a page.
"""

from rig.alarms.alarm_list import AlarmList, AlarmRow, AlarmState
from rig.alarms.catalogue import CATALOGUE, AlarmKey, Grade
from rig.alarms.what_raises import OF_CAMERA, EndedSession, HowEnded, Seen, conditions, happened
