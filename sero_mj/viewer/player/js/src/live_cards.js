/** What the cards of a live page say: as the server writes them. */

import * as THREE from "three";

/** @typedef {{kind: number, item: number, at: number[], lines: [string, string][], title: string,
 *   share: number | null, sign: "" | "positive" | "negative", stale: boolean, always: boolean}} Sent */
/** @typedef {import("./cards.js").Content} Content */

const BILLBOARD = 2; // kind of joints' cards, `Kind` in Python

/**
 * Contents of cards; their keys are kind and item.
 * @param {Sent[]} cards @param {number} selected joint; -1 for none @returns {Content[]}
 */
export function contentsOf(cards, selected) {
  return cards.map(({ kind, item, at, lines, title, share, sign, stale, always }) => {
    const isChosen = kind === BILLBOARD && item === selected;
    return { key: `${kind} ${item}`, title: title ?? "", lines, sign, isStale: Boolean(stale), isChosen,
      at: new THREE.Vector3().fromArray(at), load: always || isChosen ? Infinity : share ?? -1 };
  });
}
