"""What is wrong with the rig at this moment, as a control room shows it: alarms with cause, remedy and times.

`catalogue` names every alarm there is, `conditions` says which of them what a desk sees raises, `alarm_list`
keeps their states. Nothing here asks a device, a session or a page.
"""

from rig.alarms.alarm_list import AlarmList, AlarmRow, AlarmState
from rig.alarms.catalogue import CATALOGUE, OF_PAGE, Alarm, AlarmKey, Grade
from rig.alarms.conditions import EndedSession, HowEnded, Seen, conditions, happened
