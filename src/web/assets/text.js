// Numbers, days and names as a reader sees them: units everywhere, a real minus sign, missing is a dash and never 0.

export const MISSING = '–';

const MINUS = '\u2212';
const THIN = '\u202f';

export function number(value, digits = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return MISSING;
  const text = value.toFixed(digits);
  return (Number(text) === 0 ? text.replace('-', '') : text).replace('-', MINUS);
}

export const signed = (value, digits = 2) => (value > 0 && Number(value.toFixed(digits)) !== 0 ? '+' : '') + number(value, digits);

export const count = (value) => String(value).replace(/\B(?=(\d{3})+$)/g, THIN);

export const counted = (value, one, many = `${one}s`) => `${count(value)} ${value === 1 ? one : many}`;

export function percent(share) {
  if (share === null || share === undefined) return MISSING;
  if (share > 0 && share < 0.005) return `<${THIN}1${THIN}%`;
  if (share < 1 && share >= 0.995) return `>${THIN}99${THIN}%`;
  return `${Math.round(share * 100)}${THIN}%`;
}

const DAY_MS = 86_400_000;

/** Days since 1970 of a local day `YYYY-MM-DD`: a number to draw with and to count in. */
export const dayNumber = (date) => Date.parse(`${date}T00:00:00Z`) / DAY_MS;

export const dayOf = (number) => new Date(number * DAY_MS).toISOString().slice(0, 10);

const format = (options) => {
  const formatter = new Intl.DateTimeFormat('en-GB', { timeZone: 'UTC', ...options });
  return (date) => formatter.format(new Date(`${date}T00:00:00Z`)).replaceAll('Sept', 'Sep');
};
export const longDay = format({ weekday: 'long', day: 'numeric', month: 'long', year: 'numeric' });
export const shortDay = format({ weekday: 'short', day: 'numeric', month: 'short', year: 'numeric' });
export const plainDay = format({ day: 'numeric', month: 'short', year: 'numeric' });
export const dayMonth = format({ day: 'numeric', month: 'short' });
export const month = format({ month: 'short' });

/** An instant in the reader's own time zone. */
export const instant = (time) => new Date(time).toLocaleString('en-GB', {
  day: 'numeric', month: 'short', year: 'numeric', hour: '2-digit', minute: '2-digit', timeZoneName: 'short',
});

/** Today where the station is; without a zone its days are those of UTC. */
export function today(timezone) {
  const parts = (zone) => new Intl.DateTimeFormat('en-CA', { timeZone: zone, year: 'numeric', month: '2-digit', day: '2-digit' });
  try {
    return parts(timezone ?? 'UTC').format(new Date());
  } catch {
    return parts('UTC').format(new Date());
  }
}

export function ago(date, now) {
  const days = dayNumber(now) - dayNumber(date);
  if (days === 0) return 'today';
  if (days === 1) return 'yesterday';
  if (days === -1) return 'tomorrow';
  if (days > 730) return `${Math.round(days / 365.25)} years ago`;
  return days < 0 ? `in ${counted(-days, 'day')}` : `${counted(days, 'day')} ago`;
}

/** The year in which the season of a day begins: seasons run from 1 July. */
export const seasonOf = (date) => Number(date.slice(0, 4)) - (date.slice(5, 7) < '07' ? 1 : 0);

export const seasonName = (year) => `${year}/${String((year + 1) % 100).padStart(2, '0')}`;

const four = (year) => String(year).padStart(4, '0');

export const seasonRange = (year) => [`${four(year)}-07-01`, `${four(year + 1)}-06-30`];

/** How each variable is named, measured and drawn. */
export const VARIABLES = {
  air_temperature: { name: 'Air temperature', unit: '°C', digits: 1, kind: 'line', zero: true },
  wind_speed: { name: 'Wind speed', unit: 'm/s', digits: 1, kind: 'line', floor: 0 },
  wind_direction: { name: 'Wind from', unit: '°', digits: 0, kind: 'direction', floor: 0, ceiling: 360 },
  new_snow_24h: { name: 'New snow, 24 h', unit: 'cm', digits: 0, kind: 'bars', floor: 0 },
  new_snow_index: { name: 'New-snow index', unit: '', about: '0 to 10', digits: 0, kind: 'bars', floor: 0, ceiling: 10 },
  snow_height: { name: 'Snow height', unit: 'cm', digits: 0, kind: 'line', floor: 0 },
  cumulative_snow_index: { name: 'Cumulative snow index', unit: '', digits: 0, kind: 'line', floor: 0 },
  precipitation_24h: { name: 'Precipitation, 24 h', unit: 'mm', digits: 1, kind: 'bars', floor: 0 },
  snow_temperature: { name: 'Snow temperature', unit: '°C', digits: 1, kind: 'line', zero: true, ceiling: 0 },
  foot_penetration: { name: 'Foot penetration', unit: 'cm', digits: 0, kind: 'line', floor: 0 },
  cloud_cover: { name: 'Cloud cover', unit: '%', digits: 0, kind: 'line', floor: 0, ceiling: 100 },
  insolation_index: { name: 'Insolation index', unit: '', about: '2 to 20', digits: 0, kind: 'line', floor: 0, ceiling: 20 },
  snow_drift: { name: 'Snow drift', unit: '', kind: 'flags' },
  rain_at_900m: { name: 'Rain at 900 m', unit: '', kind: 'flags' },
};

const SECTORS = ['N', 'NNE', 'NE', 'ENE', 'E', 'ESE', 'SE', 'SSE', 'S', 'SSW', 'SW', 'WSW', 'W', 'WNW', 'NW', 'NNW'];

export const variableName = (name) => VARIABLES[name]?.name ?? name.replaceAll('_', ' ');

export function valueText(name, value) {
  const variable = VARIABLES[name];
  if (value === null || value === undefined) return MISSING;
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (variable?.kind === 'direction') return `${number(value, 0)}° ${SECTORS[Math.round(value / 22.5) % 16]}`;
  return `${number(value, variable?.digits ?? 1)} ${variable?.unit ?? ''}`.trim();
}

export const LEADS = { 0: 'Nowcast', 1: 'One day ahead' };

export const CATEGORIES = { avalanche_day: 'Avalanche day', no_avalanche_day: 'No avalanche day' };

/** What counts as an avalanche day. */
export const LABELS = {
  observed: 'at least one avalanche observed in the region',
  presumed: 'at least one avalanche observed, or judged likely though none was seen',
};

export const ACTIVITIES = {
  observed: 'avalanche observed', presumed: 'judged likely, none seen', none: 'none', unknown: 'unknown',
};

export const MODELS = {
  svm: 'SVM (this model)', climatology: 'Climatology', persistence: 'Persistence', knn10: 'Nearest neighbours, k = 10',
  knn30: 'Nearest neighbours, k = 30', logistic: 'Logistic regression',
};
