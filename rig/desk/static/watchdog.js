// The watchdog: the page itself finds, without any server, that a desk or a session is silent.
// Slow comes before dead: a desk whose page is late may still answer LIGHT OFF on its other port.
window.rigJudge = ({since, answers, session}, {staleS, deadS}) => {
  // since: s since the last news; answers: whether the other port answers, null while that is open
  const late = since > staleS;
  if (late && (answers === false || since > deadS)) return {state: 'dead', behindS: since};
  if (late) return {state: 'slow', behindS: since};
  const behindS = session === null ? 0 : session.age_s + since;
  return behindS > staleS ? {state: 'behind', behindS} : {state: 'live', behindS: 0};
};
(() => {
  const ASK_MS = 1000, ASK_WITHIN_MS = 1500;
  let newsAt = null, newsTime = null, session = null, answers = null, askedAt = -Infinity;
  const clock = time => time.toLocaleTimeString('en-GB');
  const seconds = s => s.toFixed(0) + ' s';
  function ask() {
    const now = performance.now();
    if (now - askedAt < ASK_MS) return;
    askedAt = now;
    const other = location.protocol + '//' + location.hostname + ':' + rigDesk.offPort;
    // any answer shows that it lives
    fetch(other, {mode: 'no-cors', signal: AbortSignal.timeout(ASK_WITHIN_MS)})
      .then(() => { answers = true; }, () => { answers = false; });
  }
  function texts({state, behindS}) {
    const lost = rigDesk.lost;
    if (state === 'dead')
      return ['Not connected: ' + lost.title + (newsTime === null ? ' since this page was opened' :
        ' (last heard at ' + clock(newsTime) + '); what is shown is from then'), lost.remedy];
    if (state === 'slow') return ['The desk is slow: what is shown is ' + seconds(behindS) + ' behind', ''];
    if (state === 'behind')
      return [session.who + ' does not answer: what is shown of it is ' + seconds(behindS) + ' behind', ''];
    return ['', ''];
  }
  function look() {
    const bar = document.getElementById('watchdog');
    if (!bar) return;
    const since = (performance.now() - (newsAt === null ? 0 : newsAt)) / 1000;
    if (since > rigDesk.staleS) ask(); else answers = null;
    const verdict = rigJudge({since, answers, session}, rigDesk), dead = verdict.state === 'dead';
    document.documentElement.classList.toggle('dead', dead);
    document.documentElement.classList.toggle('old', verdict.state === 'behind');
    const [head, remedy] = texts(verdict), shown = head + remedy;
    if (bar.dataset.shown !== shown) {
      bar.dataset.shown = shown;
      bar.replaceChildren(document.createTextNode(head));
      const small = document.createElement('small');
      small.textContent = remedy;
      bar.append(small);
      bar.hidden = !shown;
    }
    if (window.rigCry) window.rigCry(dead ? 'desk lost' : null);
  }
  window.rigNews = newSession => {
    newsAt = performance.now(); newsTime = new Date(); session = newSession;
    look();
  };
  setInterval(look, 250);
})();
