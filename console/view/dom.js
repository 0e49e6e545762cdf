// Templates: h() describes an element, mount() keeps the page as a function describes it, refresh() asks for that again.

/**
 * @typedef {string | number | bigint | boolean | null | undefined} Text
 * @typedef {Described | Text | any[]} Child
 * @typedef {{ tag: string, key: unknown, props: Record<string, any>, children: (Described | string)[] }} Described
 */

const SVG = "http://www.w3.org/2000/svg";
const SVG_TAGS = new Set(["svg", "path"]);

/** What each element was described as last. @type {WeakMap<Node, Described>} */
const described = new WeakMap();

/**
 * Describes an element: "p.dim" is a paragraph of the class dim. Properties come first, if there are any: attributes; `on…`, a
 * handler; `key`, the name by which an element is found again among its siblings; `mounted`, called once with the element.
 * @param {string} name
 * @param {...(Record<string, any> | Child)} rest
 * @returns {Described}
 */
export function h(name, ...rest) {
  const [tag = "", ...classes] = name.split(".");
  const props = isProperties(rest[0]) ? { .../** @type {Record<string, any>} */ (rest.shift()) } : {};
  if (classes.length) props["class"] = [...classes, props["class"]].filter(Boolean).join(" ");
  const { key, ...others } = props;
  return { tag, key, props: others, children: flat(/** @type {Child[]} */ (rest)) };
}

/** @param {unknown} value */
const isProperties = (value) => typeof value === "object" && value !== null && !Array.isArray(value) && !("tag" in value);

/**
 * One list; texts that follow each other are one.
 * @param {Child[]} children
 * @param {(Described | string)[]} found
 */
function flat(children, found = []) {
  for (const child of children) {
    if (Array.isArray(child)) flat(child, found);
    else if (child === null || child === undefined || typeof child === "boolean" || child === "") continue;
    else if (typeof child === "object") found.push(child);
    else if (typeof found.at(-1) === "string") found.push(`${found.pop()}${child}`);
    else found.push(String(child));
  }
  return found;
}

/** @type {Element | undefined} */
let place;
/** @type {() => Child} */
let content = () => null;
let isDue = false;

/**
 * Shows what this function describes, from now on.
 * @param {Element} host
 * @param {() => Child} describe
 */
export function mount(host, describe) {
  place = host;
  content = describe;
  refresh();
}

/** Shows everything as it is now, soon and once. */
export function refresh() {
  if (isDue) return;
  isDue = true;
  setTimeout(() => {
    isDue = false;
    if (place) paint(place, flat([content()]));
  });
}

/** Elements that were made, and what is to be called with them. @type {[Element, (element: any) => void][]} */
let made = [];

/**
 * @param {Element} host
 * @param {(Described | string)[]} wanted
 */
function paint(host, wanted) {
  reconcile(host, wanted);
  const mounted = made;
  made = [];
  for (const [element, call] of mounted) call(element);
}

/** @param {Node | null} node */
const keyOf = (node) => (node ? described.get(node)?.key : undefined);

/**
 * Makes the children of an element those that are wanted. What is there already stays, so that focus, selection and scroll
 * positions do, too.
 * @param {Element} parent
 * @param {(Described | string)[]} wanted
 */
function reconcile(parent, wanted) {
  const keys = new Set(wanted.flatMap((each) => (typeof each === "string" || each.key === undefined ? [] : [each.key])));
  /** @type {Map<unknown, Element>} */
  const kept = new Map();
  for (const child of [...parent.childNodes]) {
    const key = keyOf(child);
    if (key === undefined) continue;
    if (keys.has(key)) kept.set(key, /** @type {Element} */ (child));
    else child.remove();
  }
  /** @type {ChildNode | null} */
  let at = parent.firstChild;
  for (const each of wanted) {
    const found = typeof each === "string" ? textAt(at) : each.key === undefined ? elementFrom(at, each.tag) : kept.get(each.key);
    const node = found ?? (typeof each === "string" ? document.createTextNode(each) : create(each, parent));
    if (node === at) at = at.nextSibling;
    else parent.insertBefore(node, at);
    if (typeof each === "string") {
      if (node.nodeValue !== each) node.nodeValue = each;
    } else update(/** @type {Element} */ (node), each);
  }
  while (at) {
    const next = at.nextSibling;
    at.remove();
    at = next;
  }
}

/** @param {ChildNode | null} at */
const textAt = (at) => (at instanceof Text ? at : undefined);

/**
 * The first element without a key from here on that has this tag.
 * @param {ChildNode | null} at
 * @param {string} tag
 */
function elementFrom(at, tag) {
  for (let node = at; node; node = node.nextSibling) {
    const known = described.get(node);
    if (known && known.key === undefined && known.tag === tag) return node;
  }
  return undefined;
}

/**
 * @param {Described} wanted
 * @param {Element} parent
 */
function create({ tag, props }, parent) {
  const isSvg = SVG_TAGS.has(tag) || parent.namespaceURI === SVG;
  const element = isSvg ? document.createElementNS(SVG, tag) : document.createElement(tag);
  if (props["mounted"]) made.push([element, props["mounted"]]);
  return element;
}

/**
 * @param {Element} element
 * @param {Described} wanted
 */
function update(element, wanted) {
  const before = described.get(element)?.props ?? {};
  described.set(element, wanted);
  for (const name of Object.keys(before)) if (!(name in wanted.props)) set(element, name, undefined);
  for (const [name, value] of Object.entries(wanted.props)) {
    if ((name !== "value" || wanted.tag === "progress") && before[name] !== value) set(element, name, value);
  }
  reconcile(element, wanted.children);
  // Last, because the value of a list is one of its options.
  const { value } = wanted.props;
  const field = /** @type {HTMLInputElement} */ (element);
  if (value !== undefined && field.value !== value && wanted.tag !== "progress") field.value = value;
  if ("checked" in wanted.props) field.checked = wanted.props["checked"] === true;
}

/**
 * @param {Element} element
 * @param {string} name
 * @param {any} value
 */
function set(element, name, value) {
  if (name === "mounted") return;
  if (name.startsWith("on")) /** @type {any} */ (element)[name] = value ?? null;
  else if (value === undefined || value === null || (value === false && !name.startsWith("aria-"))) element.removeAttribute(name);
  else element.setAttribute(name, value === true && !name.startsWith("aria-") ? "" : String(value));
}
