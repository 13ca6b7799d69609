"""What a running session tells on this machine, and the orders it takes: how a desk watches and acts.

A session answers on a loopback port of its own, which the file `.channel.json` in its folder names with the
secret that opens it; both ends prove that they know it, and neither says it. It only ever answers: nothing
waits for a reader, and without one nothing is prepared.
"""

from rig.channel.event_log import newest_first
from rig.channel.few_connections import MOST_CONNECTIONS, FewConnections
from rig.channel.line import Line, NoSession, SessionBusy, SessionPicture, Stranger, running_sessions
from rig.channel.loopback import CHANNEL_NAME
from rig.channel.of_commands import devices_now, light_told
from rig.channel.server import Channel, Orders
from rig.channel.session_news import SessionNews
