"""What a running session tells on this machine, and the orders it takes: how a desk watches and acts.

A session answers on a loopback port of its own, which the file `.channel.json` in its folder names with the
key that opens it; only its user can read that file. It only ever answers: nothing waits for a reader, and
without one nothing is prepared.
"""

from rig.channel.line import Line, NoSession, SessionBusy, SessionPicture, running_sessions
from rig.channel.of_commands import devices_now, light_told
from rig.channel.server import CHANNEL_NAME, LOOPBACK, Channel, Orders, QuietServer
from rig.channel.session_news import SessionNews, newest_first
