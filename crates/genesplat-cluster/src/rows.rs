//! Rows on their way to new owners.

use genesplat_core::{BackendError, DeviceState, EditPart, Gaussians, RowEdit, Statistics};

use crate::backend::ClusterBackend;
use crate::group::Group;
use crate::shares::{Shares, places_in};
use crate::wire::{Reader, Writer};

/// A change of rows, and who holds them before and after it.
struct Move<'a> {
    group: &'a Group,
    /// What each rank makes.
    parts: Vec<EditPart>,
    before: Shares,
}

impl ClusterBackend {
    /// Applies a plan of density control, and deals the rows out anew.
    pub(crate) fn move_rows(&mut self, edit: &RowEdit) -> Result<(), BackendError> {
        let after = Shares::new(edit.sources.len(), self.group.count());
        let rank = self.group.rank();
        self.group.agree(self.own.ensure_rows(after.of(rank).len()))?;
        let parts = after.all().map(|rows| edit.part(rows)).collect();
        let mut rows = Move { group: &self.group, parts, before: self.shares.clone() };
        let state = rows.apply(self.own.take_state())?;
        self.own.put_state(state);
        self.shares = after;
        Ok(())
    }
}

impl Move<'_> {
    /// The mean is emptied, and so are the columns of density control. One table after the other, so that at
    /// most one exists twice.
    fn apply(&mut self, mut state: DeviceState) -> Result<DeviceState, BackendError> {
        self.fetch(&mut state.cloud)?;
        self.own_part().apply_to_cloud(&mut state.cloud);
        for moment in [&mut state.moments.first, &mut state.moments.second, &mut state.moments.pending] {
            self.fetch(moment)?;
            self.own_part().apply_to_moment(moment);
        }
        let Statistics { gene_gradient_sum, gene_views, .. } = std::mem::take(&mut state.statistics);
        state.statistics.gene_gradient_sum = self.column(&gene_gradient_sum)?;
        state.statistics.gene_views = self.column(&gene_views)?;
        state.mean = Default::default();
        Ok(state)
    }

    fn own_part(&self) -> &EditPart {
        &self.parts[self.group.rank()]
    }

    /// The old rows that a rank needs of those that are held here, counted from the first one here.
    fn wanted(&self, rank: usize) -> Vec<u32> {
        let (rows, share) = (&self.parts[rank].rows, self.before.of(self.group.rank()));
        rows[places_in(rows, &share)].iter().map(|&row| row - share.start as u32).collect()
    }

    /// From the old rows that are held to those that are needed.
    fn fetch(&mut self, table: &mut Gaussians) -> Result<(), BackendError> {
        let part = |rank: usize| {
            let mut out = Writer::default();
            // Nothing is pending, or something of every row.
            let wanted = if table.is_empty() { Vec::new() } else { self.wanted(rank) };
            out.cloud(&table.gather(&wanted), 0..wanted.len());
            out.words
        };
        let parts = (0..self.group.count()).map(part).collect();
        *table = Gaussians::default();
        for part in self.group.exchange(Ok(parts))? {
            Reader::new(&part).cloud(table);
        }
        Ok(())
    }

    /// The new rows of a column, or none where there were none.
    fn column<T: bytemuck::Pod>(&mut self, column: &[T]) -> Result<Vec<T>, BackendError> {
        let part = |rank: usize| {
            let mut out = Writer::default();
            if !column.is_empty() {
                let rows: Vec<T> = self.wanted(rank).iter().map(|&row| column[row as usize]).collect();
                out.rows(&rows);
            }
            out.words
        };
        let parts = (0..self.group.count()).map(part).collect();
        let received = self.group.exchange(Ok(parts))?.concat();
        let rows: &[T] = bytemuck::cast_slice(&received);
        Ok(if rows.is_empty() { Vec::new() } else { self.own_part().gather(rows) })
    }
}
