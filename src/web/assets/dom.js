// Elements without markup: what comes from the API becomes a text node or an attribute and never HTML.

const SVG = 'http://www.w3.org/2000/svg';

function fill(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? '' : String(value));
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false && child !== ''));
  return element;
}

/** An HTML element; a falsy child is left out. */
export const h = (name, attributes, ...children) => fill(document.createElement(name), attributes, children);

/** An SVG element. */
export const s = (name, attributes, ...children) => fill(document.createElementNS(SVG, name), attributes, children);

export const byId = (id) => document.getElementById(id);

/** Puts `children` in the place of what `element` holds. */
export function show(element, ...children) {
  element.replaceChildren(...children.flat(Infinity).filter(Boolean));
  element.removeAttribute('aria-busy');
}

/** A table from rows of cells; a cell is a text, an element, or `{ value, ...attributes }`. The first cell heads its row. */
export function table(caption, heads, rows, attributes = {}) {
  const cell = (name, content, more = {}) => {
    const plain = content === null || typeof content !== 'object' || content instanceof Node || Array.isArray(content);
    const { value, ...own } = plain ? { value: content } : content;
    return h(name, { ...more, ...own }, value);
  };
  return h('div', { class: 'scroll', tabindex: '0', role: 'region', 'aria-label': caption },
    h('table', attributes,
      h('caption', null, caption),
      h('thead', null, h('tr', null, heads.map((head) => cell('th', head, { scope: 'col' })))),
      h('tbody', null, rows.map(({ cells, ...own }) => h('tr', own,
        cells.map((content, column) => (column === 0 ? cell('th', content, { scope: 'row' }) : cell('td', content))))))));
}

/** Draws now and again whenever the width of the figure changes: marks and text keep their size on every screen. */
export function drawn(element, draw) {
  let last = 0;
  const redraw = () => {
    const width = Math.floor(element.clientWidth);
    if (width > 0 && width !== last) {
      last = width;
      element.replaceChildren(draw(width));
    }
  };
  // after the frame, not within: a figure that grows may bring a scroll bar, which changes the width of all the others
  new ResizeObserver(() => setTimeout(redraw)).observe(element);
  return element;
}
