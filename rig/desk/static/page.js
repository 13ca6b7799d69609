// Small functions of the page: showing a panel, labels for screen readers, numbers of charts.
window.rigShow = name => document.querySelector(`[data-panel="${name}"]:not(.q-tab--active)`)?.click();
// the frame around a picture has its label, so the picture needs none
new MutationObserver(() => {
  document.querySelectorAll('.picture img:not([alt])').forEach(image => { image.alt = ''; });
  // a wide table also scrolls by keys
  document.querySelectorAll('.q-table__middle:not([tabindex])').forEach(table => { table.tabIndex = 0; });
})
  .observe(document.documentElement, {childList: true, subtree: true});
// a number of a chart with its unit
window.rigNumber = (value, unit) => {
  if (Array.isArray(value)) value = value[value.length - 1];
  if (value == null || !isFinite(value)) return '–';
  // a label at zero is the sum of steps, with an error of rounding
  if (Math.abs(value) < 1e-12) value = 0;
  const number = Number(Number(value).toPrecision(6)).toString().replace('-', '−');
  return unit ? number + ' ' + unit : number;
};
