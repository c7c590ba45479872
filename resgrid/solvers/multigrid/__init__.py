"""Conjugate gradients preconditioned by multigrid: the algorithm on one page.

`MultigridFactor` solves ``A x = b`` for the nodal matrix of a grid or a netlist, in this order:
1. *Before*: corridors, chains and trees have been eliminated (`resgrid.solvers.star_mesh`).
2. *Boards* (`boards`, `lattice`, `board_setup`). A grid has two colours, and every resistor joins a red cell to a
   black one: conductances are kept face by face over the red cells, in flat arrays without indices, in double
   precision and in single. They cover the box of cells that carry current. Cells are numbered with odd strides, so
   that the neighbour across a face lies at the same distance for all red cells. What fits no face is a link: a
   resistor that closes a ring, or leads to a node beside the lattice.
3. *Coarse levels* (`coarsening.coarsen`, `block_kernels`, `grid_levels`) are boards again. A node is the connected
   part of a block of two cells a side, cut where a conductance is weak beside the strongest at either end, so that no
   node joins across a wall; further parts of a block become nodes beside the lattice. Axes that conduct badly are left
   for later. Middle to middle, two blocks are joined through half of either one's own resistance in series with what
   lies between (plain aggregation would make long ways too easy). Where many blocks have fallen apart, graphs take
   over (`levels`): there aggregates are taken from blocks too, and corridors one node wide shrink by exact elimination.
4. *Netlists* without a grid have graphs from the first level on: aggregates grown node by node along the strongest
   conductances (`clusters`), rows laid out by colour and length (`ordering`).
5. *Iteration* (`board_iteration`, `graph_iteration`). Flexible conjugate gradients (Notay 2000), on boards for the
   black cells alone: the red ones are eliminated exactly. Vectors are in single precision; after a burst of at most
   five digits the residual is formed anew from the true conductances, and the search directions go on. It ends at
   ``rtol |b|``, or where rounding, ``eps |A| |x|``, forbids more (`stopping`: or, from a guess on, where the steps
   tell that the error is small).
6. *Cycle* (`board_cycle`, `kernels`). One relaxation of the black cells before and one after each visit of the next
   level, so that the preconditioner is symmetric; K-cycles (Notay & Vassilevski 2008) on the coarse levels: one or
   two steps of conjugate gradients, each preconditioned by the level below. The coarsest matrix is inverted. Subnormal
   numbers count as zero meanwhile (`subnormals`).
7. *Passes* (`board_passes`, `waves`). The time is that of reading conductances from memory. In a wave red cells go
   ahead of black ones by as far as neighbours reach, so that a pass reads them once; the finish of the cycle and the
   product that follows it are two waves, one close behind the other. The product takes conductances in single
   precision and makes up for their rounding on the diagonal (`boards.compensated`): rows sum to what leaks, so that
   smooth vectors, of which only differences count, are multiplied as well as others.
8. *Refinement* (`resgrid.solvers.refine`) makes a normwise answer right entry by entry: voltages in double-double, with
   exponents where doubles run out, every pass a solution to many digits of what is largest, until what all rows
   violate KCL by proves that no entry is off by more than 4e-9 of itself and the rounding of the sums. The last rows,
   mostly in slits, are solved directly with what surrounds them (`pockets`): corrected, or, where no digit is right,
   found anew from what flows in, hundreds of decades at once.
9. *Grading* (`grading`, `graded`, `foresight`, `graded_solver`). Where a potential falls by many decades, coarse nodes
   move their members in proportion to it, and all decades gain digits alike. What it will be is foreseen from coarse
   to fine: a small level solved directly, its answer spread, and made better on every level by a multiplicative cycle,
   in which all numbers stay positive and every decade counts alike. Where grading fails, plain levels have their turn.

References
----------
Notay, Flexible conjugate gradients, SIAM J. Sci. Comput. 22 (2000) 1444.
Notay & Vassilevski, Recursive Krylov-based multigrid cycles, Numer. Linear Algebra Appl. 15 (2008) 473.
Notay, An aggregation-based algebraic multigrid method, Electron. Trans. Numer. Anal. 37 (2010) 123.
O'Cinneide, Entrywise perturbation theory and error analysis for Markov chains, Numer. Math. 65 (1993) 109.
Doob, Conditional Brownian motion and the boundary limits of harmonic functions, Bull. SMF 85 (1957) 431.
Horton & Leutenegger, A multi-level solution algorithm for steady-state Markov chains, ACM SIGMETRICS 22 (1994) 191.
Braess, Towards algebraic multigrid for elliptic problems of second order, Computing 55 (1995) 379 (why plain aggregates
need their conductances corrected).
"""
