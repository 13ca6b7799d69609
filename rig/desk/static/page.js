// Small helps of the page.
window.rigShow = name => document.querySelector(`[data-panel="${name}"]:not(.q-tab--active)`)?.click();
// the frame of a picture has its name; the picture in it has none of its own
new MutationObserver(() => {
  document.querySelectorAll('.picture img:not([alt])').forEach(one => { one.alt = ''; });
  // a wide table scrolls, with the keys, too
  document.querySelectorAll('.q-table__middle:not([tabindex])').forEach(one => { one.tabIndex = 0; });
})
  .observe(document.documentElement, {childList: true, subtree: true});
// a number of a chart with its unit
window.rigNumber = (value, unit) => {
  if (Array.isArray(value)) value = value[value.length - 1];
  if (value == null || !isFinite(value)) return '–';
  // a mark at zero, after sums of steps
  if (Math.abs(value) < 1e-12) value = 0;
  const number = Number(Number(value).toPrecision(6)).toString().replace('-', '−');
  return unit ? number + ' ' + unit : number;
};
