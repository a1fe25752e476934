// The public API as the pages call it: JSON in, or a problem that says what is wrong.

import { askKey, keyHeader } from './key.js';

/** What the API refused, in its own words. */
export class Problem extends Error {
  constructor(status, body) {
    super(body?.detail ?? body?.title ?? `the service answered ${status}`);
    this.status = status;
    this.title = body?.title ?? `Answer ${status}`;
    this.detail = body?.detail ?? '';
    this.code = body?.code ?? '';
    this.traceId = body?.traceId ?? '';
  }
}

async function read(path) {
  let response;
  try {
    response = await fetch(path, { headers: { Accept: 'application/json', ...keyHeader() }, cache: 'no-cache' });
  } catch {
    throw new Problem(0, { title: 'The service cannot be reached', detail: `${location.origin} did not answer.` });
  }
  const body = await response.json().catch(() => null);
  if (!response.ok) throw new Problem(response.status, body);
  return body;
}

/** Reads `path`; where a key is needed, asks for one and tries again. */
export async function get(path) {
  for (;;) {
    const used = keyHeader().Authorization;
    try {
      return await read(path);
    } catch (problem) {
      if (problem.status !== 401) throw problem;
      // another call may have been given the key while this one was under way
      if (keyHeader().Authorization === used) await askKey(problem);
    }
  }
}

/** Reads every page of a list: `name` is the member that holds the items. */
export async function all(path, name) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(cursor === null ? path : `${path}${path.includes('?') ? '&' : '?'}cursor=${encodeURIComponent(cursor)}`);
    items.push(...page[name]);
    cursor = page.next;
  } while (cursor !== null);
  return items;
}

/** An address below a station. */
export const ofStation = (id, rest = '') => `/v1/stations/${encodeURIComponent(id)}${rest}`;

/** A query from what is neither null nor undefined. */
export function query(parameters) {
  const given = Object.entries(parameters).filter(([, value]) => value !== null && value !== undefined);
  return given.length === 0 ? '' : `?${new URLSearchParams(given)}`;
}

/** Runs `work` now and `seconds()` after each end of it, only while somebody looks. */
export function repeat(work, seconds) {
  let timer = null;
  const run = async () => {
    clearTimeout(timer);
    timer = null;
    if (document.hidden) return;
    await work();
    clearTimeout(timer);
    timer = setTimeout(run, seconds() * 1000);
  };
  document.addEventListener('visibilitychange', () => { if (!document.hidden) run(); });
  return run();
}
