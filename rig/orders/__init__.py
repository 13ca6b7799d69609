"""What a running session tells on this machine, and the orders it takes: how a desk watches and acts.

A session answers on a loopback port of its own, which the file `.orders.json` in its folder names with the
key that opens it; only its user can read that file. It only ever answers: nothing waits for a reader, and
without one nothing is prepared.
"""

from rig.orders.line import NoSession, OrderConnection, SessionBusy, running_sessions
from rig.orders.server import LOOPBACK, ORDERS_NAME, Orders, OrderSocket, devices_now, light_told
from rig.orders.session_news import PATH_S, SessionNews, SessionPicture, thinned_path
