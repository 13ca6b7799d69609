// What the buttons of a chart do, and how a number is written with its unit.
window.rigNumber = (value, unit) => {
  if (Array.isArray(value)) value = value[value.length - 1];
  if (value == null || !isFinite(value)) return '–';
  const number = Number(Number(value).toPrecision(6)).toString().replace('-', '−');
  return unit ? number + ' ' + unit : number;
};
(() => {
  const ends = (chart, axis, row) => chart.getModel().getComponent(axis, row).axis.scale.getExtent();
  const keep = (url, name) => Object.assign(document.createElement('a'), {href: url, download: name}).click();
  const cell = text => /[",\n]/.test(text) ? '"' + String(text).replaceAll('"', '""') + '"' : text;
  window.rigRows = chart => {
    // what is seen: the curves between the ends of the axes as they are zoomed
    const shown = chart.getOption(), rows = [['curve', 'x', 'x value', 'y', 'y value']];
    for (const one of shown.series) {
      const row = one.xAxisIndex || 0, [low, high] = ends(chart, 'xAxis', row);
      const [under, over] = ends(chart, 'yAxis', row);
      if (one.tooltip && one.tooltip.show === false) continue;
      for (const point of one.data || []) {
        if (point[0] == null || point[0] < low || point[0] > high) continue;
        if (point[1] == null || point[1] < under || point[1] > over) continue;
        rows.push([one.name, shown.xAxis.at(-1).name, point[0], shown.yAxis[row].name, point[1]]);
      }
    }
    return rows;
  };
  window.rigPicture = element => {
    const svg = element.querySelector('svg').cloneNode(true), style = getComputedStyle(element);
    const {width, height} = element.getBoundingClientRect();
    svg.setAttribute('width', width); svg.setAttribute('height', height);
    const text = new XMLSerializer().serializeToString(svg)
      .replace(/var\((--[\w-]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
    return new Promise((done, failed) => {
      const image = new Image(), canvas = document.createElement('canvas');
      canvas.width = 2 * width; canvas.height = 2 * height;
      image.onload = () => {
        const to = canvas.getContext('2d');
        to.fillStyle = style.getPropertyValue('--card'); to.fillRect(0, 0, canvas.width, canvas.height);
        to.drawImage(image, 0, 0, canvas.width, canvas.height);
        done(canvas.toDataURL('image/png'));
      };
      image.onerror = failed;
      image.src = 'data:image/svg+xml;charset=utf-8,' + encodeURIComponent(text);
    });
  };
  document.addEventListener('click', async event => {
    const button = event.target.closest('[data-chart]');
    if (!button) return;
    const component = getElement(Number(button.dataset.chart)), chart = component && component.chart;
    // one that was not seen yet is not drawn yet
    if (!chart) return;
    const name = component.$el.getAttribute('aria-label').replace(/[^\w]+/g, '-');
    if (button.dataset.do === 'png') keep(await window.rigPicture(component.$el), name + '.png');
    if (button.dataset.do === 'csv') {
      const text = window.rigRows(chart).map(row => row.map(cell).join(',')).join('\n') + '\n';
      keep(URL.createObjectURL(new Blob([text], {type: 'text/csv'})), name + '.csv');
    }
    const zoom = chart.getOption().dataZoom[0], middle = (zoom.start + zoom.end) / 2;
    const half = (zoom.end - zoom.start) / 2 * {in: 0.5, out: 2}[button.dataset.do];
    if (button.dataset.do === 'all')
      for (const dataZoomIndex of [0, 1])
        chart.dispatchAction({type: 'dataZoom', dataZoomIndex, start: 0, end: 100});
    else if (half) chart.dispatchAction({type: 'dataZoom', dataZoomIndex: 0,
      start: Math.max(0, middle - half), end: Math.min(100, middle + half)});
  });
})();
