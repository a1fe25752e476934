// The key of the API: asked for where the service wants one, kept only as long as the tab is open.

import { byId, h, show } from './dom.js';

const NAME = 'firn-key';

export function keyHeader() {
  const key = sessionStorage.getItem(NAME);
  return key === null ? {} : { Authorization: `Bearer ${key}` };
}

let asking = null;
// who does not want to give a key is not asked again by every look at the jobs
let declined = false;

/** Asks once, however many calls wait for the answer; refuses with `problem` if nobody gives a key. */
export function askKey(problem) {
  if (declined) return Promise.reject(problem);
  asking ??= ask(problem).finally(() => { asking = null; showKey(); });
  return asking;
}

function ask(problem) {
  return new Promise((resolve, reject) => {
    const input = h('input', { id: 'key-input', type: 'password', autocomplete: 'off', spellcheck: 'false', required: true });
    const dialog = h('dialog', { 'aria-labelledby': 'key-title' },
      h('form', { method: 'dialog' },
        h('h2', { id: 'key-title' }, 'This service needs a key'),
        h('p', null, `${problem.title}: ${problem.detail}.`),
        h('label', { for: 'key-input' }, 'Key'), input,
        h('p', { class: 'muted' }, 'The operator makes one with ', h('code', null, 'firn key create'),
          '. It is kept until this tab is closed.'),
        h('div', { class: 'buttons' },
          h('button', { type: 'submit', value: 'use', class: 'primary' }, 'Use the key'),
          h('button', { type: 'submit', value: 'cancel', formnovalidate: true }, 'Cancel'))));
    dialog.addEventListener('close', () => {
      // what is pasted from a terminal may bring white space or signs that no header can carry
      const key = input.value.trim();
      dialog.remove();
      if (dialog.returnValue !== 'use' || !/^[\x21-\x7e]+$/.test(key)) {
        declined = true;
        return reject(problem);
      }
      sessionStorage.setItem(NAME, key);
      resolve();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** A way to forget the key, where there is one, and to give one after all. */
export function showKey() {
  const place = byId('key');
  if (place === null) return;
  if (declined) return show(place, h('button', { type: 'button', onclick: () => location.reload() }, 'Give a key'));
  if (sessionStorage.getItem(NAME) === null) return show(place);
  const forget = () => { sessionStorage.removeItem(NAME); location.reload(); };
  show(place, h('button', { type: 'button', onclick: forget }, 'Forget the key'));
}
