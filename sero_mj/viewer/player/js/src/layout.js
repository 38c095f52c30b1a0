/** Computes positions of billboards in a column, close to their items and without overlap. */

/**
 * Returns the centers of boxes that are placed one below the other.
 * @param {number[]} wanted preferred centers in ascending order @param {number[]} heights heights of the boxes
 * @param {number} gap distance between two boxes @param {number} low @param {number} high bounds of the column
 * @returns {number[]}
 */
export function stacked(wanted, heights, gap, low, high) {
  /** Distance of each center below the first one if all boxes touch. */
  const below = heights.map((_, k) =>
    heights.slice(0, k).reduce((sum, each) => sum + each + gap, 0) + (heights[k] - heights[0]) / 2);
  /** Boxes that touch form one block at the mean of their preferred positions. */
  /** @type {{sum: number, count: number}[]} */
  const pools = [];
  wanted.forEach((middle, k) => {
    let pool = { sum: middle - below[k], count: 1 };
    while (pools.length) {
      const last = pools[pools.length - 1];
      if (last.sum / last.count <= pool.sum / pool.count) break;
      pools.pop();
      pool = { sum: pool.sum + last.sum, count: pool.count + last.count };
    }
    pools.push(pool);
  });
  const first = low + heights[0] / 2, end = heights.length - 1;
  const last = Math.max(high - heights[end] / 2 - below[end], first);
  const bases = pools.flatMap(({ sum, count }) => Array(count).fill(sum / count));
  return bases.map((base, k) => Math.min(Math.max(base, first), last) + below[k]);
}
