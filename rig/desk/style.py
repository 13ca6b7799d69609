"""How the page looks: the style of its head, its panels, and what they are made of. Colours are `theme`'s."""

from rig.desk.theme import named_colours

STYLE = (
    named_colours()
    + """
body { background: var(--ground); color: var(--ink); font-size: 16px; }
h1, h2, h3 { font: inherit; margin: 0; }
h1 { white-space: nowrap; }
/* the height of the head, and what is left between alarms, panels' names and the safety bar */
:root { --head: 40px; --room: calc(100vh - 190px);
  /* what is read at a laptop's screen is larger on a larger one */
  --small: clamp(14px, 1.05vw, 20px); }
.unseen { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.q-header { background: var(--card) !important; color: var(--ink); min-height: var(--head);
  padding: 2px 12px !important; align-items: center !important; gap: 8px; }
.q-header .state { min-width: 0; }
.q-page, .q-tab-panels, .q-tab-panel { background: var(--ground) !important; color: var(--ink); }
.q-tab-panel { padding: 6px 10px; gap: 8px; }
/* the page scrolls, and no panel in it once more */
.q-panel.scroll, .q-tab-panel { overflow: visible; }
.q-tab-panel > * { gap: 8px; }
.nicegui-content { padding: 0; gap: 4px; }
.box { background: var(--card); border-radius: 6px; padding: 10px 12px; gap: 6px; min-width: 0; }
.title { color: var(--dim); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }
.huge { font-size: clamp(56px, 9.4vw, 120px); line-height: 1; font-weight: 600; white-space: nowrap;
  font-variant-numeric: tabular-nums; letter-spacing: -.03em; }
.huge .unit { font-size: .25em; letter-spacing: 0; font-weight: 400; color: var(--dim); }
.verdict { font-size: clamp(44px, 7vw, 80px); line-height: 1; font-weight: 700; }
.advice { font-size: clamp(26px, 3.2vw, 40px); line-height: 1.15; font-weight: 600; }
.middle { font-size: 28px; line-height: 1.2; font-variant-numeric: tabular-nums; }
.drawn { flex: 0 1 300px; min-width: 0; }
.stack { display: flex; flex-flow: column; gap: 8px; min-width: 0; }
.stack > .box { width: 100%; } .stack > .grows { flex: 1 1 0; min-height: 140px; }
.grid { display: grid; gap: 8px; width: 100%; grid-template-columns: minmax(0, 1fr); }
.lamps { display: flex; flex-wrap: wrap; gap: 6px; }
.lamps > span { border: 2px solid currentColor; border-radius: 6px; padding: 3px 10px; font-weight: 600; }
.lamps > .no { background: var(--no-ground); color: var(--on-ground); border-color: var(--no-ground); }
.step { min-width: 44px; min-height: 40px; }
.steps { display: flex; flex-wrap: wrap; gap: 4px 18px; list-style: none; margin: 0; padding: 0; }
.steps li { color: var(--dim); border-bottom: 3px solid transparent; padding: 2px 0; }
.steps li[aria-current] { color: var(--ink); font-weight: 700; border-color: var(--line); }
.against { display: grid; grid-template-columns: minmax(0, auto) minmax(60px, 1fr) auto; gap: 4px 10px;
  align-items: center; width: 100%; font-variant-numeric: tabular-nums; }
.against .track { position: relative; height: 14px; border: 1px solid var(--edge); border-radius: 3px; }
.against .track i { position: absolute; inset: 0 auto 0 0; background: currentColor; border-radius: 2px; }
.against .track b { position: absolute; top: -4px; bottom: -4px; width: 2px; background: var(--ink); }
.against .dim .track { border-style: dashed; }
.against .note { grid-column: 1 / -1; color: var(--dim); font-size: 13px;
  line-height: 1.1; margin-top: -3px; }
.nicegui-echart { width: 100%; min-height: 130px; }
.chart { width: 100%; display: flex; flex-direction: column; min-height: 150px; flex: 1 1 auto; }
.chart .nicegui-echart { flex: 1 1 auto; height: auto; }
.chart.square { flex: 0 0 auto; min-height: 0; } .chart .whole { width: 100%; }
.chart.square .nicegui-echart { aspect-ratio: 1; min-height: 0; flex: 0 0 auto; margin: 0 auto; }
.chart .tools { display: flex; align-items: center; gap: 6px; flex-wrap: wrap; }
.chart .tools button { font: inherit; font-size: 13px; color: var(--line); background: none; cursor: pointer;
  border: 1px solid var(--edge); border-radius: 4px; padding: 2px 8px; min-height: 24px; }
.cries { position: sticky; top: var(--head); z-index: 1000; width: 100%; }
.errors > div { display: flex; align-items: center; gap: 12px; padding: 4px 12px; background: var(--raised);
  color: var(--ink); border-left: 6px solid var(--no); border-bottom: 1px solid var(--edge); }
.errors > div > :first-child { flex: 1 1 auto; overflow-wrap: anywhere; }
.why-none { font-size: 20px; text-align: center; width: 80%; color: #fff; }
.rows { border-collapse: collapse; width: 100%; font-size: var(--small); line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.rows td, .rows th { padding: 2px 8px 2px 0; vertical-align: top; text-align: left; font-weight: 400; }
.rows .judged { white-space: nowrap; width: 1%; }
.rows th { color: var(--dim); white-space: nowrap; }
.dim { color: var(--dim); } .go { color: var(--go); } .caution { color: var(--warn); }
.no { color: var(--no); font-weight: 700; }
a { color: var(--line); }
.light { display: inline-block; width: 12px; height: 12px; border-radius: 6px; margin-right: 6px; }
.alarm { background: var(--alarm); color: var(--on-ground); font-size: 26px; font-weight: 700;
  padding: 8px 14px; animation: flash 1s steps(2, jump-none) infinite; width: 100%; }
.instruction { background: var(--told); color: var(--on-ground); font-size: 30px; font-weight: 700;
  padding: 8px 14px; width: 100%; }
@keyframes flash { from { box-shadow: inset 0 0 0 5px var(--ink) } to { box-shadow: none } }
@media (prefers-reduced-motion: reduce) { .alarm { animation: none; } }
.events { font-size: var(--small); overflow-y: auto; width: 100%; flex: 1 1 120px; min-height: 90px; }
svg text { fill: var(--dim); font-size: 12px; }
.camera { width: 100%; }
.picture { background: #000; } .picture img { touch-action: none; }
:focus-visible { outline: 3px solid var(--line); outline-offset: 2px; }

.report { width: min(1000px, 94vw); max-width: 94vw !important; height: calc(100vh - 90px); padding: 8px;
  margin-bottom: 64px; position: relative; z-index: 1; }
.q-dialog__inner:focus-visible { outline: none; }
.report iframe { width: 100%; flex: 1 1 auto; border: 0; background: var(--ground); }
.find { width: 260px; }

/* what Quasar has white, grey or blue of its own */
#q-loading-bar { display: none; }
.q-btn { color: var(--line); }
.q-btn--outline::before { border-color: var(--edge); }
.q-tab { color: var(--dim); opacity: 1 !important; }
.q-tab--active { color: var(--ink); }
.q-tab__indicator { background: var(--line); }
.q-field__native, .q-field__input, .q-field__prefix, .q-field__suffix, .q-select__dropdown-icon,
.q-field__append, .q-field__marginal, .q-checkbox__label { color: var(--ink); }
.q-field__label, .q-field__messages, .q-field__bottom { color: var(--dim); }
.q-field--outlined .q-field__control::before { border-color: var(--edge) !important; }
.q-field--focused .q-field__control::after { border-color: var(--line) !important; }
.q-field--error .q-field__messages, .q-field--error .q-field__label { color: var(--no) !important; }
.q-placeholder::placeholder { color: var(--dim); opacity: 1; }
.q-checkbox__inner { color: var(--edge) !important; }
.q-checkbox__inner--truthy { color: var(--line) !important; }
.q-card, .q-menu, .q-drawer { background: var(--card) !important; color: var(--ink); }
.q-card { border: 1px solid var(--edge); }
.q-item { color: var(--ink); } .q-item--active { color: var(--line); font-weight: 700; }
.q-table__card, .q-table { background: var(--card) !important; color: var(--ink) !important; }
.q-table th { color: var(--dim); opacity: 1 !important; }
.q-table__bottom, .q-table__control { color: var(--ink) !important; }
.q-table tbody td, .q-table th { border-color: var(--edge) !important; font-size: var(--small); }
.q-tooltip { background: var(--raised); color: var(--ink); border: 1px solid var(--edge); font-size: 14px; }
.q-linear-progress { color: var(--line) !important; }
.q-spinner { color: var(--line); }
.q-expansion-item__container > .q-item { padding: 4px 0; min-height: 32px; }
@layer theme {
  .q-notification, .q-notification.bg-negative, .q-notification.bg-warning { color: var(--ink) !important;
    background: var(--raised) !important; border: 2px solid var(--edge); }
  .q-notification.bg-negative { border-color: var(--no) !important; }
  .q-notification .q-btn { color: var(--line) !important; }
  .q-btn.bg-positive { background: var(--go-ground) !important; color: var(--on-ground) !important; }
  .q-btn.bg-negative { background: var(--no-ground) !important; color: var(--on-ground) !important; }
  .q-btn.bg-primary { background: var(--raised) !important; color: var(--ink) !important; }
  .q-btn.text-primary, .text-primary { color: var(--line) !important; }
  .text-negative { color: var(--no) !important; } .text-grey { color: var(--dim) !important; }
  .text-white { color: inherit !important; }
  .nicegui-html a, .nicegui-link { color: var(--line) !important; }
}

/* a room's own arrangement, from a laptop's screen on; narrower ones have all below each other */
@media (min-width: 1000px) {
  .fills { min-height: var(--room); }
  .align { grid-template-columns: minmax(0, 7fr) minmax(300px, 3fr); }
  .thirds { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .halves { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .wide-left { grid-template-columns: minmax(0, 3fr) minmax(320px, 2fr); }
  .measure { grid-template-columns: minmax(0, 4.6fr) minmax(0, 4fr) minmax(0, 3.4fr); }
  .measure > * { max-height: max(600px, var(--room)); }
  .measure .camera { width: min(100%, calc((max(600px, var(--room)) - 344px) * var(--aspect)));
    margin: 0 auto; }
  .shrinks, .scrolls { overflow-y: auto; min-height: 0; }
  .stack > .shrinks { flex: 0 1 auto; }
  .align > .scrolls { max-height: max(500px, var(--room)); }
  /* below it are the buttons */
  .align .camera { width: min(100%, calc((max(500px, var(--room)) - 76px) * var(--aspect)));
    margin: 0 auto; }
  .at-once { display: flex; flex-flow: column; gap: 8px; width: 100%; height: max(560px, var(--room)); }
  .at-once > .grid { flex: 1 1 0; min-height: 0; grid-template-rows: minmax(0, 1fr); }
  .at-once .chart.square { flex: 1 1 0; }
  .at-once .whole { flex: 1 1 0; min-height: 0; container-type: size; display: grid;
    place-items: center; }
  .at-once .whole > .nicegui-echart { width: min(100cqw, 100cqh); }
}
@media (max-width: 999px) {
  .q-tab { padding: 0 10px; } .rows th { white-space: normal; }
  .told { flex-wrap: wrap !important; } .drawn { flex: 1 1 100%; }
}
@media (max-width: 600px) {
  .q-header .spare { display: none; }
  .q-header .state { flex: 1 1 0; } .q-header .q-space { display: none; }
  .q-tab { min-width: 0; padding: 0 8px; text-transform: none; }
  .q-tab-panel { padding: 4px; } .box { padding: 8px; }
}
"""
)
