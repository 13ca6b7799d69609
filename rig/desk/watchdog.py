"""The page's own watchdog: what is older than two seconds is grey and says since when, without any server.

A desk that has died, a session that has stopped to answer: the page sees it by itself, cries, and says what
to do. Alarms are told to the browser, too, which shows them over other windows.
"""

import json

from rig.alarms import CATALOGUE, AlarmKey
from rig.control import STALE_S

BAR = """
<div id="watchdog" role="alert" aria-live="assertive" hidden></div>
"""
STYLE = """
#watchdog { position: fixed; top: 0; left: 0; right: 0; z-index: 19999;
  background: var(--bar-ink); color: var(--bar); font-size: 20px; font-weight: 700; padding: 8px 14px;
  border-bottom: 6px solid var(--off); }
#watchdog[hidden] { display: none; }
#watchdog small { display: block; font-size: 16px; font-weight: 400; }
html.dead .q-tab-panels, html.dead .cries, html.dead .q-header, html.old .live, .blind .camera,
.blind .huge, .blind .chart.square { filter: grayscale(1) opacity(.5); }
/* the watchdog says it, and more */
.nicegui-error-popup { display: none !important; }
/* what cried then may be over */
html.dead .cries { visibility: hidden; }
"""


def script() -> str:
    """What the watchdog does."""
    lost = CATALOGUE[AlarmKey.DESK_LOST]
    told = json.dumps({"title": lost.title, "remedy": lost.remedy})
    return _SCRIPT.replace("DESK_LOST", told).replace("STALE_S", f"{STALE_S:g}")


_SCRIPT = """
(() => {
  const lost = DESK_LOST;
  let heard = null, heardAt = null, old = null, told = new Set();
  const clock = at => at.toLocaleTimeString('en-GB');
  function look() {
    const bar = document.getElementById('watchdog');
    if (!bar) return;
    const now = performance.now(), since = heard === null ? now / 1000 : (now - heard) / 1000;
    const dead = since > STALE_S;
    const stale = old !== null && old.age_s + since > STALE_S;
    document.documentElement.classList.toggle('dead', dead);
    document.documentElement.classList.toggle('old', stale);
    let shown = '';
    if (dead) {
      const at = heardAt === null ? 'since this page was opened' : '(last heard at ' + clock(heardAt) + ')';
      shown = lost.title.toUpperCase() + ' ' + at + (heardAt === null ? '' :
        ': WHAT IS SHOWN IS FROM THEN') + '\\n' + lost.remedy;
    } else if (stale) {
      shown = (old.who + ' has not answered since ' + old.at).toUpperCase() +
        ': WHAT IS SHOWN OF IT IS FROM THEN';
    }
    if (bar.dataset.shown !== shown) {
      bar.dataset.shown = shown;
      const [head, remedy] = shown.split('\\n');
      bar.replaceChildren(document.createTextNode(head || ''));
      const small = document.createElement('small');
      small.textContent = remedy || '';
      bar.append(small);
      bar.hidden = !shown;
      if (dead && shown) notify('desk lost', head, remedy);
    }
    if (window.rigCry) window.rigCry(dead ? 'desk lost' : null);
  }
  function notify(tag, title, body) {
    if (!('Notification' in window) || Notification.permission !== 'granted') return;
    try {
      const shown = new Notification(title, {body: body, tag: tag, requireInteraction: true});
      window.rigNotified = (window.rigNotified || []).concat([title]);
      shown.onclick = () => window.focus();
    } catch (error) { console.log('no notification: ' + error); }
  }
  window.rigAlarms = (crying, session) => {
    heard = performance.now(); heardAt = new Date(); old = session;
    const now = new Set(crying.map(one => one.name));
    for (const one of crying) if (!told.has(one.name)) notify(one.key, one.title, one.text);
    told = now;
    look();
  };
  // a browser asks only when a person has pressed something
  document.addEventListener('click', () => {
    if ('Notification' in window && Notification.permission === 'default') Notification.requestPermission();
  }, {once: true, capture: true});
  setInterval(look, 250);
})();
"""
